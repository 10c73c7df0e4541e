"""The model of the fish, and everything that thinks with it.

``fishmodel``: four numbers and what they predict. ``swim``, ``fitting``: the numbers from swims.
``runs``, ``guided``, ``table``, ``account``: identification. ``identified``: what is known of one
fish, kept on disk. ``design``, ``certificate``, ``series``: gain, lead and filter, and what they
will do. ``planner``, ``belief``, ``modellaw``, ``provenance``: learning with the model.
"""
