"""What the scores of many objects and pairs say together."""
