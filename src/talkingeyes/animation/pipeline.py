"""From sampled head and gaze to an animation: one list of steps, in one place.

    head and gaze of the model, frame by frame
      -> GazeTrajectory       saccades detected; the head contributes to large gaze shifts
      -> STEPS                each changes the trajectory only where the controls say so; later steps take precedence
      -> blinks               sampled; gaze is held while the lids are shut, then STEPS run again
      -> Motion               rendered at the frame rate, with the face, then parts replaced or switched off

A step is a function (trajectory, context) -> trajectory in a file of `animation/steps/`, with its reason and source. A
new one is one file and one line in STEPS. A step that needs no later frame also works in a stream (CAUSAL_STEPS).
"""

from __future__ import annotations

from collections.abc import Callable

from talkingeyes.animation.animation import Animation, render_trajectory
from talkingeyes.animation.blink_sampling import sample_blinks, shut_frames
from talkingeyes.animation.context import AnimationContext
from talkingeyes.animation.face import with_face
from talkingeyes.animation.gaze_trajectory import GazeTrajectory, clamp_changed_gaze, hold_gaze
from talkingeyes.animation.part_overrides import override_events, override_motion
from talkingeyes.animation.shift_reasons import shift_reasons
from talkingeyes.animation.steps.amplitude_limit import limit_amplitude
from talkingeyes.animation.steps.eye_contact import apply_eye_contact
from talkingeyes.animation.steps.head_contribution import add_head_contribution
from talkingeyes.animation.steps.listening import add_nods, look_at_partner
from talkingeyes.animation.steps.liveliness import apply_liveliness
from talkingeyes.animation.steps.saccadic_intrusions import add_saccadic_intrusions
from talkingeyes.animation.steps.states import calm_head, look_by_state
from talkingeyes.animation.steps.style_transfer import apply_style
from talkingeyes.animation.steps.target_following import apply_targets
from talkingeyes.corpus.samples import FaceSamples

Step = Callable[[GazeTrajectory, AnimationContext], GazeTrajectory]

STEPS: tuple[Step, ...] = (
    apply_style,
    apply_liveliness,
    calm_head,
    add_nods,
    apply_eye_contact,
    look_at_partner,
    look_by_state,
    limit_amplitude,
    add_saccadic_intrusions,
    apply_targets,
)
CAUSAL_STEPS: tuple[Step, ...] = (apply_liveliness,)


def animate_sample(
    sampled: GazeTrajectory, faces: FaceSamples | None, index: int, fps: float, context: AnimationContext
) -> Animation:
    """The animation of sample `index` at a frame rate, from its sampled head and gaze and the samples of the face."""
    generated = add_head_contribution(sampled, context)
    trajectory = apply_steps(generated, context)
    blinks = sample_blinks(trajectory, context)
    if blinks.spontaneous:
        held = hold_gaze(generated, shut_frames(blinks.spontaneous, generated.times_s))
        trajectory = apply_steps(held, context)
    animation = render_trajectory(trajectory, blinks.all, fps)
    motion = with_face(animation.motion, faces, index, context.controls.face) if faces else animation.motion
    motion = override_motion(motion, context.controls.parts)
    generated_gaze = context.controls.parts.is_generated("gaze")
    reasons = shift_reasons(trajectory, context) if generated_gaze else ()
    return Animation(motion, override_events(animation.events, motion, context.controls.parts), reasons)


def apply_steps(generated: GazeTrajectory, context: AnimationContext) -> GazeTrajectory:
    """Apply all steps; what they changed stays within the range of the eyes."""
    trajectory = generated
    for step in STEPS:
        trajectory = step(trajectory, context)
    return clamp_changed_gaze(trajectory, generated)
