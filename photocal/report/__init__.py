"""Certificates and technical reports; studies beside what they printed."""
