"""Helpers that several packages share: files, arguments, extras, snapshots, pictures and processes."""
