"""The thesis recomputed: its laws (firmware/ilc and host/native/thesis), plants, examples, claims.

``chapter2`` … ``chapter8`` hold the examples with the checks of the claims in ``ledger.toml``,
``figures`` what is drawn of them, ``plants`` the cases they are about. ``series`` and
``plants.feedback`` run trial after trial, ``study`` runs an example.
"""
