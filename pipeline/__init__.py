"""Order, storage, machines, people: what drives the stages."""
