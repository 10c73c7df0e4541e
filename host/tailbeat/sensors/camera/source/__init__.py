"""Where pictures come from: films, stills, connected cameras."""
