"""A datagram path below a Zenoh link: it keeps a radio's budget, and takes the best of several radios to a neighbour.

A host's bearer listens on each of its radios. The router's own link goes to a port of the bearer on loopback; the far
bearer hands it to its router's loopback listener. QUIC, with its TLS, stays between the two routers: what a bearer
carries it neither reads nor changes.
"""
