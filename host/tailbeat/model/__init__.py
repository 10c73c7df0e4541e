"""The model of the fish, and everything that thinks with it.

``fishmodel``: four numbers and what they predict. ``fitting``: the numbers from swims.
``identified``: what is known of one fish, kept on disk. ``design``: gain, lead and filter with a
certificate. ``planner``: the best amplitudes for a reference. ``modellaw``: learning with the model.
"""
