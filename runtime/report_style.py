"""The style sheet of a report: one column on a phone, light and dark, colours for all eyes.

Series colours are those of Okabe and Ito, which people with any kind of colour vision tell apart,
darkened on white and lightened on black.
"""

from __future__ import annotations

__all__ = ["STYLE"]

STYLE = """\
:root { color-scheme: light dark;
  --paper: #fbfbfa; --ink: #1d1f23; --quiet: #5c6068; --rule: #d9dadd; --card: #ffffff;
  --mark: #e8f1fb; --c0: #0064a8; --c1: #c04f00; --c2: #007a58; --c3: #a8487f; --c4: #8a6a00;
  --c5: #2c7fb0; --c6: #7a4fb5; --c7: #5f6b78; }
@media (prefers-color-scheme: dark) { :root {
  --paper: #16171a; --ink: #e9eaec; --quiet: #a3a7af; --rule: #3a3d43; --card: #1e2024;
  --mark: #22344a; --c0: #6cb8f0; --c1: #ff9a55; --c2: #3fcf9f; --c3: #e79ac6; --c4: #f0c23c;
  --c5: #9fd3f5; --c6: #c3a6ef; --c7: #b3bfcc; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink);
  font: 16px/1.5 system-ui, sans-serif; -webkit-text-size-adjust: 100%; }
main { max-width: 70rem; margin: 0 auto; padding: 1rem; }
h1 { font-size: 1.6rem; line-height: 1.2; margin: .5rem 0 1rem; text-wrap: balance; }
h2 { font-size: 1.25rem; margin: 2.2rem 0 .4rem; }
h3 { font-size: 1rem; margin: 1.2rem 0 .4rem; overflow-wrap: anywhere; }
p { max-width: 44rem; margin: .5rem 0 .8rem; }
.lead { font-size: 1.1rem; }
.note { border-left: 3px solid var(--c0); padding-left: .8rem; overflow-wrap: anywhere; }
.wide { overflow-x: auto; margin: .6rem 0; border: 1px solid var(--rule); border-radius: 6px;
  background: var(--card); }
table { border-collapse: separate; border-spacing: 0; width: 100%; font-size: .875rem;
  font-variant-numeric: tabular-nums; }
th, td { padding: .4rem .5rem; text-align: right; white-space: nowrap; }
thead th { color: var(--quiet); font-weight: 500; white-space: normal;
  border-bottom: 1px solid var(--rule); vertical-align: bottom; }
th:first-child { text-align: left; position: sticky; left: 0; background: var(--card); }
tbody th { font-weight: 500; }
tbody tr + tr > * { border-top: 1px solid var(--rule); }
tr.best > *, tr.best > th:first-child { background: var(--mark); }
@media (max-width: 40rem) { tbody th { white-space: normal; min-width: 6.5rem; } }
.pair, .three { display: grid; gap: 1rem; grid-template-columns: minmax(0, 1fr); }
@media (min-width: 52rem) { .pair { grid-template-columns: repeat(2, minmax(0, 1fr)); } }
.three { gap: .5rem; grid-template-columns: repeat(auto-fit, minmax(min(100%, 10rem), 1fr)); }
@media (max-width: 33rem) { .three figure:last-child { grid-column: 1 / -1; } }
figure { margin: 0; }
figcaption { font-size: .875rem; color: var(--quiet); margin: .2rem 0 .4rem; }
img { width: 100%; height: auto; display: block; border-radius: 6px; }
.pair svg { width: 100%; height: auto; display: block; background: var(--card);
  border: 1px solid var(--rule); border-radius: 6px; }
svg text { font: 15px system-ui, sans-serif; fill: var(--quiet); stroke: none; }
svg .grid { stroke: var(--rule); stroke-width: 1; opacity: .6; }
svg .axis { stroke: var(--quiet); stroke-width: 1; }
svg .reference { stroke: var(--quiet); stroke-width: 1.2; stroke-dasharray: 5 4; }
svg .front { fill: none; stroke: var(--quiet); stroke-width: 5; opacity: .3; }
svg .line { fill: none; stroke-width: 1.5; opacity: .7; }
svg .s0 { fill: var(--c0); stroke: var(--c0); } svg .s1 { fill: var(--c1); stroke: var(--c1); }
svg .s2 { fill: var(--c2); stroke: var(--c2); } svg .s3 { fill: var(--c3); stroke: var(--c3); }
svg .s4 { fill: var(--c4); stroke: var(--c4); } svg .s5 { fill: var(--c5); stroke: var(--c5); }
svg .s6 { fill: var(--c6); stroke: var(--c6); } svg .s7 { fill: var(--c7); stroke: var(--c7); }
svg g { stroke: none !important; } svg polyline.line { fill: none; }
.legend { list-style: none; display: flex; flex-wrap: wrap; gap: .2rem 1.1rem; padding: 0;
  margin: .6rem 0; font-size: .875rem; }
.legend li { display: flex; align-items: center; gap: .35rem; overflow-wrap: anywhere; }
.key { width: 1rem; height: 1rem; flex: none; }
.bar { display: flex; margin: .4rem 0; align-items: center; gap: .6rem;
  font-size: .875rem; color: var(--quiet); max-width: 24rem; }
.ramp { flex: 1; height: .8rem; border-radius: 3px; }
"""
