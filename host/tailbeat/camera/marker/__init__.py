"""What is on the fish, and how it is found in a picture."""
