"""The command line: each command reads its options, calls `api` and prints the results."""
