"""The definitions once more as one would write them from the page; shares no code with the stages. See `method`."""
