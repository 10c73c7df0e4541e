"""The thesis recomputed: its laws (firmware/ilc, the same C), its plants, its examples, its claims.

``chapter2`` … ``chapter8`` hold the examples with their claims and figures, ``plants`` the cases
they are about, ``series`` and ``plants.feedback`` run trial after trial, ``study`` runs an example.
"""
