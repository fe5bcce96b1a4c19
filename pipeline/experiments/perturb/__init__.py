"""How the scores answer to known alterations."""
