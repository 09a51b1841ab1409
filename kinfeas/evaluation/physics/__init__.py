"""The PyBullet world: episodes in it, environments, films, and a robot behind a bus."""
