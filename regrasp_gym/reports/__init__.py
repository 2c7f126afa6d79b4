"""What commands write: messages, files, tables and plots."""
