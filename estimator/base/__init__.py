"""Array types, frames, the state vector, errors, and checks of configuration.

Imports nothing of this project. Everything else may import it.
"""
