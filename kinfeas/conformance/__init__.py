"""What every motion generator keeps to: the rules, the trial that shows it, and checks at work."""
