"""What differs between Linux, macOS and Windows. Nothing outside this package asks which it is.

Functions that decide by the system take its name (as in ``sys.platform``), so that each is tested
for all three; modules that only one system has are imported where they are used.
"""
