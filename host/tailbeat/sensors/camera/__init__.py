"""Speed of the fish from a camera above the tank."""
