"""Jobs, restartable calls with a JSON file each, and sweeps."""
