"""Benchmarks: result tables and pictures of policies."""
