"""Built-in motion generators, registered by the same entry points as anyone's."""
