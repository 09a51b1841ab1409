"""Files: folders, tables, run logs, demonstrations and policy metadata.

May import core and config.
"""
