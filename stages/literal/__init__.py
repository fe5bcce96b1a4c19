"""Second, literal implementation of the definitions; shares no code with the stages. See `method`."""
