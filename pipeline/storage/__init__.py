"""A run's folder: its tables, the ledger of finished jobs, the lock, and the run's record."""
