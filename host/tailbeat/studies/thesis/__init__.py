"""The thesis recomputed: its laws (firmware/ilc, the same C), its plants, its examples, its claims.

``learner`` and ``feedback`` bind the laws, ``chapter2`` … ``chapter8`` hold the examples,
``examples`` lists them, ``study`` runs one with its claims.
"""
