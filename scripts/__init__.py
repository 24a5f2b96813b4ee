"""What developers run: pins, licences, distributions, audits."""
