"""The clock offset between camera and board."""
