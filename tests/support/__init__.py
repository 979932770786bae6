"""What tests share: benches, programs, readers of files. Nothing here is a test."""
