"""Play a bag over DDS, message by message as it was recorded.

    python player.py BAG PERIOD_S

Waits until someone listens to each topic, plays once with so much time after each image, and ends.
"""

import importlib
import sys
import time
from pathlib import Path

import rclpy
from rclpy.node import Node
from rosbags.highlevel import AnyReader


def main(bag, period_s):
    rclpy.init()
    node = Node("player")
    with AnyReader([Path(bag)]) as reader:
        publishers = {
            connection.topic: node.create_publisher(
                message_class(connection), connection.topic, 1000
            )
            for connection in reader.connections
        }
        while not all(publisher.get_subscription_count() for publisher in publishers.values()):
            time.sleep(0.05)
        messages = list(reader.messages())
        for connection, _, raw in messages[:1] * 5:  # until both sides know of each other
            publishers[connection.topic].publish(bytes(raw))
            time.sleep(0.2)
        for connection, _, raw in messages:
            publishers[connection.topic].publish(bytes(raw))
            if kind(connection) == "Image":
                time.sleep(period_s)
    time.sleep(1.0)
    node.destroy_node()
    rclpy.shutdown()


def kind(connection):
    return connection.msgtype.rpartition("/")[2]


def message_class(connection):
    package = connection.msgtype.partition("/")[0]
    return getattr(importlib.import_module(f"{package}.msg"), kind(connection))


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]))
