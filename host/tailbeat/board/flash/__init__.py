"""New firmware onto the board, without losing what the board has learned."""
