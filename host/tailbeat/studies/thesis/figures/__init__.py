"""The thesis's figures under their own numbers; a few that it does not have carry a name."""
