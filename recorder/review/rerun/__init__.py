"""The recorded journal through today's arbiter: the same decisions? And with other settings?"""
