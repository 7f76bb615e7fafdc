"""What was found and how it is said: findings, hypotheses, texts in both languages, documents."""
