"""The field side: record, import, replay and inspect flights; owner of the flight log."""
