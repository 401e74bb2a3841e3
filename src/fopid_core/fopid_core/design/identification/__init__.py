"""The process learnt from recorded signals."""
