"""What runs in each process of a training with physics: a batch, without any learning library."""

import signal
from multiprocessing.connection import Connection

from kinfeas.core.errors import KinfeasError
from kinfeas.training.batch import Batch
from kinfeas.training.config import TrainConfig
from kinfeas.training.worlds import physics_world


def serve(pipe: Connection, config: TrainConfig, rows: int) -> None:
    """Step a batch of `rows` episodes as asked; each answer has the number of the next episode."""
    # Ctrl-C is for the process that asks.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        batch = Batch(physics_world(config), rows, config.action_repeat)
        pipe.send(None)
        while True:
            kind, what = pipe.recv()
            if kind == "begin":
                batch.next_episode = what
                pipe.send((batch.start(), batch.next_episode))
            else:
                pipe.send((batch.step(what), batch.next_episode))
    except KinfeasError as error:
        pipe.send(error)
    except (EOFError, BrokenPipeError):
        return  # nobody is there
