"""What stands before requests: connections, slow bodies, pages of others that ask in the name of a browser, and requests for heads."""
