"""Summary of a comparison: medians, best number of environments per engine, ratios to the fastest peer."""

import statistics
from typing import Any

OWN = "warpcontact"


def summarise(entries: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Returns one row per benchmark scene and engine, at its best number of environments.

    Args:
        entries: Results of single processes: ``scene``, ``engine``, ``envs``, ``env_steps_per_s`` and more.
    """
    rows = []
    for scene, engine in dict.fromkeys((entry["scene"], entry["engine"]) for entry in entries):
        own = [entry for entry in entries if (entry["scene"], entry["engine"]) == (scene, engine)]
        done = [entry for entry in own if entry.get("env_steps_per_s")]
        if not done:
            rows.append({"scene": scene, "engine": engine, "why": own[0].get("why", "no run")})
            continue
        best = max(done, key=lambda entry: statistics.median(entry["env_steps_per_s"]))
        rates = best["env_steps_per_s"]
        rows.append(
            {
                "scene": scene,
                "engine": engine,
                "envs": best["envs"],
                "median": statistics.median(rates),
                "lowest": min(rates),
                "highest": max(rates),
                "cores_busy": statistics.median(best["cores_busy"]),
                "start_s": best["start_s"]["process"],
                **best["sanity"],
                "doubt": doubt(best),
            }
        )
    for row in rows:
        peers = [
            r["median"]
            for r in rows
            if r["scene"] == row["scene"] and not r["engine"].startswith(OWN) and "median" in r
        ]
        if peers and "median" in row:
            row["of_best_peer"] = round(row["median"] / max(peers), 3)
    return rows


def doubt(entry: dict[str, Any]) -> str:
    """Returns the reasons why the result of a run may be invalid; empty if there are none."""
    sanity, notes = entry["sanity"], entry.get("notes", {})
    reasons = []
    if sanity.get("not_converged"):
        reasons.append(f"{sanity['not_converged']:.2%} of the steps not converged")
    if sanity.get("not_finite"):
        reasons.append(f"{sanity['not_finite']:.2%} not finite")
    if sanity.get("below"):
        reasons.append(f"{sanity['below']:.2%} below the surface")
    if sanity.get("highest_body", 0.0) > 0.5:
        # Bodies fall 0.4 m and lose energy: after one second none can be as high as its start.
        reasons.append(f"a body {sanity['highest_body']:.2g} m above the surface")
    if notes.get("overflow"):
        reasons.append("contacts overflowed")
    return ", ".join(reasons)


def lines(rows: list[dict[str, Any]]) -> list[str]:
    """Returns the rows as lines of text, with a heading."""
    text = [
        f"{'scene':7} {'engine':24} {'envs':>8} {'env-steps/s':>11}  {'lowest … highest':>19} {'× best peer':>11} "
        f"{'cores':>5} {'sanity':>19} {'start':>7}"
    ]
    for row in rows:
        head = f"{row['scene']:7} {row['engine']:24}"
        if "why" in row:
            text.append(f"{head} {row['why']}")
            continue
        spread = f"{row['lowest']:.2e} … {row['highest']:.2e}"
        ratio = f"{row['of_best_peer']:.2f}" if "of_best_peer" in row else ""
        text.append(
            f"{head} {row['envs']:8} {row['median']:11.2e}  {spread:>19} {ratio:>11} {row['cores_busy']:5.2f} "
            f"{sanity_text(row):>19} {row['start_s']:5.1f} s{'  ! ' + row['doubt'] if row['doubt'] else ''}"
        )
    return text


def sanity_text(row: dict[str, Any]) -> str:
    """Returns the mean height of the bodies, overlap and drift of bodies, or median residual and penetration of contacts."""
    if "drift_m" in row:
        return f"{1e3 * row['penetration_m']:.3f}, {1e3 * row['drift_m']:.3f} mm"
    if "mean_height" in row:
        return f"height {row['mean_height']:.3f} m"
    return f"{row['residual_median']:.0e}, {1e3 * row['penetration_m']:.3f} mm"
