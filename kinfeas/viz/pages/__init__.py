"""Pages of HTML that stand alone: reports, and scenes to turn about."""
