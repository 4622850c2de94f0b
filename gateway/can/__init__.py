"""The CAN bus: SocketCAN, adapters through python-can, and CAN over TCP (socketcand). It touches the world."""
