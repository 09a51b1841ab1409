"""Built-in motion generators, registered by entry points as those of any other distribution."""
