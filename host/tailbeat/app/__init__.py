"""The programs: command line, live page, demo."""
