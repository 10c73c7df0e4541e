"""From pixels to metres on the water surface."""
