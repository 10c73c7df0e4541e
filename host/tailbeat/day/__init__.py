"""A day at the tank: what is done before, during and after the swims of a series.

``ritual`` makes sure that a swim may begin, ``series`` swims, keeps and learns until there is
nothing more to gain, ``trim``, ``first`` and ``resume`` are for a fish that is new or was opened.
A ``person`` is told everything and asked what only people know.
"""
