"""Writers of the result pages of docs/results/, and of what users measure on their own data."""
