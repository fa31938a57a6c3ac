"""Who may do what: keys of the setting and of the keys file, the callers who bring them, and the log of what they changed."""
