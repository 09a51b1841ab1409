"""Files: folders, tables, run logs, demonstrations, policy metadata. Imports core and config."""
