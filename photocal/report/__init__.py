"""Certificates and technical reports."""
