"""Running trials: series, preflight checks, guards, commissioning, decisions."""
