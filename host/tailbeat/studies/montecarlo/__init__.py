"""Monte Carlo over plants, laws and noise: ``recipe`` (what), ``cell`` (one piece of work),
``runner`` (all cores, or a Dask cluster), ``results`` (Parquet), ``batch`` (many fish in C).
"""
