"""What plugins keep to: the rules of motion generators, a trial of them, and checks at work."""
