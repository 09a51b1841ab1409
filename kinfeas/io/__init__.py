"""Run logs, demonstrations and policy metadata."""
