"""One controller node for many joints."""
