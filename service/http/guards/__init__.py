"""What stands before requests: connections, slow bodies, and pages of others that ask in the name of a browser."""
