"""Scores of methods: tables, aggregates with intervals, differences from the published rows."""
