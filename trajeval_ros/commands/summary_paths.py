# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every figure that a ``summary.json`` may have, so that a misspelt one is known before the run.

Which of them a summary has depends on the data: what is in none is a mistake of who asks for it,
and what is in some is absent in the others.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import pairwise

from trajeval_ros.files.fixes import Mode
from trajeval_ros.online.accounting import Reason
from trajeval_ros.online.parameters import PARAMETERS

Path = Sequence[str]

_ALIKE = 0.6

_REASONS = ",".join((*Reason, "undecodable"))
_PARAMETERS = ",".join(name for name in PARAMETERS if "." not in name)
_FIXES = ",".join((*Mode, "assumed"))
_BOTH = "{translation,rotation}"
_VALUE = "{value,std}"
_XYZ = "{value,std}.*"
_RMSE = "{ate,re}_{translation,rotation}_rmse"
_LIKELIHOOD = (
    "{log_likelihood,chi2,dof,log_det,chi2_per_dof,error_in_ground_truth_std,nats_per_pose}"
)
_QUANTILES = "{min,p5,q1,median,q3,p95,max}"
_KERNEL = "{,smooth_,rough_,correlated_noise_}"
_ERROR_MODEL = f"""
{{model,log_likelihood,nats_per_pose,nats_per_pose_uncorrected,chi2_per_dof,poses,converged,fit}}
{_BOTH}.{{jitter,drift,velocity,wander}}_std.{_VALUE} {_BOTH}.{{velocity,wander}}_time.{_VALUE}
{_BOTH}.{{jitter,drift,velocity,wander}}_std.interval.* {_BOTH}.{{velocity,wander}}_time.interval.*
{_BOTH}.long_run_drift{{,_by_distance}}.interval.*
{_BOTH}.{{long,short}}_run_drift.{_VALUE} {_BOTH}.long_run_drift_by_distance.{_VALUE}
{{clock_offset,clock_rate,scale}}.{_VALUE} clock_offset_by.{_BOTH}.{_VALUE}
stamp_std.{_VALUE} stamp_nats stamp_errors.{_BOTH}
extrinsic.{_BOTH}.{_XYZ} extrinsic.{{length,angle}}.{_VALUE}
extrinsic.{{length,angle}}_nats extrinsic.pose.*
covariance.*.* nats_per_pose_of.{{drift,velocity,wander}}
whiteness.{_BOTH}.* jumps.*.{{stamp,translation,rotation}} unobserved.*
clock_changes.*.{{begin,end,before,after,std}} clock_stretches.*.{{begin,end,offset,std}}
"""
_GROUND_TRUTH = f"""
{{received,used,pending,segments,cut}} rejected.{{{_REASONS}}} fixes.{{{_FIXES}}}
hyperparameters.{_BOTH}.{_KERNEL}length_scale
hyperparameters.{_BOTH}.{{signal,noise,smooth,rough,correlated_noise}}_std
fit.{_BOTH}_{{mean_square,noise_std}} fit.{{segments_adapted,segments_closed,stamp_std}}
faults.*.{{begin,code,count,detail,end,text}} faults.*.stamps.*
"""
_OF_ONE = f"""
{{version,gauge,position_only}} lever_arm.{_XYZ}
parameters.{{{_PARAMETERS}}} parameters.{{estimates,extrinsic}}.*
inputs.{{estimate,ground_truth}} inputs.{{estimate,ground_truth}}.{{path,bytes,sha256,topic}}
inputs.arguments.*
estimate.{{received,evaluated,pending,cut}} estimate.rejected.{{{_REASONS}}}
estimate.fixes.{{{_FIXES}}}
likely_causes.*.{{code,text,advice}}
relative.{_LIKELIHOOD} relative.{_BOTH}_rmse
absolute.{_LIKELIHOOD} absolute.log_likelihood_{{first_order,nonlinear}} absolute.{_BOTH}_rmse
absolute.consistency absolute.observability.{{motion,status}}
absolute.observability.unobserved_axes.*
{{absolute,conventional,latest_path}}.alignment.pose.*
{{absolute,conventional,latest_path}}.alignment.scale absolute.alignment.covariance.*.*
window.{{duration,poses}} window.{{relative,absolute}}.{_LIKELIHOOD}
window.{{relative,absolute}}.{{p_value,translation_rmse,rotation_rmse}}
window.absolute.{{ending,log_likelihood_first_order,log_likelihood_nonlinear,consistency}}
window.absolute.noise_equivalent_{_BOTH}_std
window.absolute.observability.{{motion,status}}
window.absolute.observability.unobserved_axes.*
conventional.{_RMSE} conventional.{{poses,pairs,re_delta,re_longest_step,re_unit,at}}
conventional.distributions.{{sampled_pairs,sampled_poses}}
conventional.distributions.{{ate,re}}_{_BOTH}.{{mean,median,std,min,max}}
coverage.{{time,distance,duration,path_length,lost_time,lost_distance,losses}}
coverage.longest_loss.{{begin,end,duration,seconds_from_start}}
drift.path_length drift.all_pairs.{{pairs,re_translation_rmse,re_rotation_rmse}}
drift.kitti.{{translation,rotation,subsequences}}
drift.kitti.lengths.*.{{length,translation,rotation,subsequences}}
drift.sub_trajectories.*.{{length,subsequences}} drift.sub_trajectories.*.{_BOTH}.{_QUANTILES}
headline.intervals.{_RMSE}.{{reason,interval.*}}
headline.without.{{poses,{_RMSE},of.*}}
headline.worst.{{stamp,seconds_from_start,translation,rotation,ground_truth_std}}
headline.ground_truth.{{translation_std,rotation_std,share_in_gaps}}
latest_path.{{poses,scored,{_RMSE}}} latest_path.online.{_RMSE}
latest_path.online.alignment.pose.* latest_path.online.alignment.scale
"""
_OF_ALL = f"""
likely_causes.*.{{code,text,advice}}
comparison.*.{{a,b,since_ns}} comparison.*.{{common,only_a,only_b}}.{{poses,seconds}}
comparison.*.nats_per_second.{{a,b,difference}}
comparison.*.{{ate,re}}_{_BOTH}.{{ratio,p_value,method,reason,rmse_a,rmse_b,errors,interval.*}}
"""


def _expanded(text: str) -> Iterator[str]:
    """``a{b,c{d,e}}`` is ab, acd and ace, as a shell has it."""
    begin = text.find("{")
    if begin < 0:
        yield text
        return
    depth, cuts = 0, [begin]
    for place in range(begin, len(text)):
        depth += {"{": 1, "}": -1}.get(text[place], 0)
        if depth == 0 or (depth == 1 and text[place] == ","):
            cuts.append(place)
        if depth == 0:
            break
    for first, last in pairwise(cuts):
        for middle in _expanded(text[first + 1 : last]):
            yield from _expanded(text[:begin] + middle + text[cuts[-1] + 1 :])


def _below(prefix: str, patterns: str) -> Iterator[str]:
    for pattern in patterns.split():
        for path in _expanded(pattern):
            yield f"{prefix}{path}"


@cache
def _figures(*, several: bool) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Of one estimate, and of all; of one alone the ground truth is in its own."""
    one = [*_below("", _OF_ONE), *_below("error_model.", _ERROR_MODEL)]
    one += _below("window.error_model.", _ERROR_MODEL)
    truth = [*_below("ground_truth.", _GROUND_TRUTH)]
    if not several:
        return (*one, *truth), ()
    return tuple(one), (*truth, *_below("", _OF_ALL))


def why_unknown(path: Path, names: Sequence[str], *, group: bool = False) -> str | None:
    """What to say of a path that no summary of these estimates has; None of any other.

    ``group``: one that has figures below it will do, too.
    """
    one, of_all = _figures(several=len(names) > 1)
    figures, before = one, ""
    if is_of_one(path, names):
        before, path = f"{path[0]}.", path[1:]
    elif len(names) > 1 and path[0] in ("ground_truth", "comparison"):
        figures = of_all
    asked = _pattern(path)
    if asked in figures or (group and any(name.startswith(f"{asked}.") for name in figures)):
        return None
    near = [before + each.replace("*", "0") for each in _near(asked, figures)]
    hint = f"; near it: {', '.join(near)}" if near else ""
    return f"no summary has a figure {before}{'.'.join(path)}{hint}"


def is_of_one(path: Path, names: Sequence[str]) -> bool:
    """Whether a path is of one of several estimates, which its first word names.

    An estimate may be called as a part of a summary is: ``estimate.received`` is each one's.
    """
    of_each = _figures(several=True)[0]
    return len(names) > 1 and path[0] in names and _pattern(path) not in of_each


def _pattern(path: Path) -> str:
    return re.sub(r"(?<=\.)\d+(?=\.|$)", "*", ".".join(path))


def _near(asked: str, figures: Sequence[str]) -> list[str]:
    """Up to three: what goes on after it, has a word that does, or is most like it in its end."""
    within = [name for name in figures if asked and name.startswith(asked)]
    if within:
        return within[:3]
    begun = [
        name
        for name in figures
        if any(word == asked or word.startswith(f"{asked}_") for word in name.split("."))
    ]
    if begun:
        return begun[:3]
    # Only where it comes to that.
    import difflib

    words = asked.count(".") + 1
    alike = {
        name: difflib.SequenceMatcher(a=".".join(name.split(".")[-words:]), b=asked).ratio()
        for name in figures
    }
    best = sorted(figures, key=lambda name: -alike[name])[:3]
    return [name for name in best if alike[name] > _ALIKE]
