"""A LeRobot processor step for policies whose actions are relative to the tool tip, as in UMI."""

import torch
from lerobot.processor import (
    AbsoluteActionsProcessorStep,
    PolicyActionProcessorStep,
    ProcessorStepRegistry,
)

from kinfeas.core import spatial


@ProcessorStepRegistry.register("kinfeas_relative_chunk")
class RelativeChunk(AbsoluteActionsProcessorStep):
    """Turns chunks relative to the observed tool tip into world poses, the actions of the robot.

    It is the last step of a policy's postprocessor. A `RelativeActionsProcessorStep` in the
    preprocessor keeps the observed state.
    """

    __call__ = PolicyActionProcessorStep.__call__

    def action(self, action: torch.Tensor) -> torch.Tensor:
        """Return world poses (b, k, 7) of positions and two columns of rotations, (b, k, 9).

        Raises:
            ValueError: If the action is no chunk, since later actions need the same observation.
        """
        if action.ndim != 3:
            raise ValueError("relative actions need whole chunks: --inference.type=rtc")
        pose = self.relative_step.get_cached_state()[:, None, :7].expand(-1, action.shape[1], -1)
        poses = spatial.from_columns(action.double().numpy(force=True))
        world = spatial.compose(pose.double().numpy(force=True), poses)
        return torch.from_numpy(world).to(action)
