"""The models that are needed most, in C; tools/vboard/native has the sources.

Each class here stands in for the reference model in Python of which it is a subclass, and does the
same at the same tick. Its state is in C; what is accessed rarely is inherited.
"""
