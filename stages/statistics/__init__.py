"""Statistics over the scores of many objects and pairs."""
