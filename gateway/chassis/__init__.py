"""The chassis on CAN: frames, their layout from the DBC, decoding, encoding, supervision, the variant."""
