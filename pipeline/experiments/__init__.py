"""Drive the same stages on made or altered scans."""
