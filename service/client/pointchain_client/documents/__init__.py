"""The JSON documents of the service as frozen dataclasses with NumPy arrays.

A document goes in; a dataclass comes out. Each member of a document is a field with the same name. Members and enum
values of a newer service are accepted: unknown members are ignored, and states, codes and verdicts are plain texts.
"""
