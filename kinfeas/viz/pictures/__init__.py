"""Pictures: what can be looked at without a browser."""
