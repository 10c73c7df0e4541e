"""When in a film the swim began, and whether it is that trial."""
