"""A `VectorEnv` under the contracts of other libraries, one file for each of them.

Each file needs the library that it is named after, and nothing else imports it.
"""
