"""Figures as PNG, SVG and PDF, drawn by matplotlib without a display."""
