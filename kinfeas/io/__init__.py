"""Files: reading and writing them whole, and the formats that are safe to read."""
