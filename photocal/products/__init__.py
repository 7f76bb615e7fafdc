"""Products and their measures: orthophotos, terrain models, fitted surfaces and volumes."""
