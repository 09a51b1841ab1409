"""Pictures, films and pages. May import training and evaluation."""
