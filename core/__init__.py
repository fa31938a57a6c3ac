"""The algorithm of panoloc: torch and numpy; no HTTP, no Redis, no logging set-up, no globals."""
