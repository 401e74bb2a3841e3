"""Plants from published equations, written without any code of the package that tunes them."""
