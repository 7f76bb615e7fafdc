"""Check points against the product: statistics, tests, accuracy standards and plausibility."""
