"""Processor, interrupts, time and bus."""
