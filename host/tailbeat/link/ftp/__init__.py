"""MAVLink FTP with a sliding window."""
