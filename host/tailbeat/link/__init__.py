"""Talking to a board: serial ports, sockets, MAVLink, signing, parameters, file transfer."""
