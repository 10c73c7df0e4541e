"""Fish model, identification, gain design, model-based learning, convergence."""
