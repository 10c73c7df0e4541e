"""Pictures of a simulated tank."""
