"""From pixels to metres: lens, plane, walls."""
