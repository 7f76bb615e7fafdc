"""What was found: one class of findings, the table of hypotheses, all texts in both languages."""
