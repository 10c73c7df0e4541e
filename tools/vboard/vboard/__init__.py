"""An ATSAM3X8E in software: it boots the very image that is flashed to the fish."""
