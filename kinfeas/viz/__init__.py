"""Pictures, films, 3-D pages and reports.

May import evaluation and lower packages.
"""
