"""rtcal's own files: written whole (`disk`), checked against types (`schema`), results (`saved`)."""
