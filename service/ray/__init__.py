"""The workers as a Ray Serve application, for those who outgrow one machine. Needs the extra `panoloc[ray]`."""
