"""Drawing, stills and films, report, and live view."""
