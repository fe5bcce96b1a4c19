"""A run's folder: tables, the ledger of finished jobs, the lock, the record."""
