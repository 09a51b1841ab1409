"""Films of episodes in PyBullet."""
