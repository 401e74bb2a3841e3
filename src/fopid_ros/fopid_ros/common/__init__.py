"""What all nodes stand on: a managed life, checked parameters, signals of any message type, diagnostics."""
