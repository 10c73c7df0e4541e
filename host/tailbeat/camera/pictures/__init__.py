"""Pictures with the time they were taken at: films, devices, still pictures."""
