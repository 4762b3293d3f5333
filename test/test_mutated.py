# Copyright 2026 The rigid_body_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
Mutated scenes, dispersions, fits, CSV files and descriptions of bags.

Each gives a result or one error line, within limits, and the file itself does not change.
"""

import json
import os
import re

import bags
from conftest import at_night, CONFIG, write_torques
from hostile import LAUGHS, line_of, outcome, TUMBLER
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from rigid_body_ros import recording
from rigid_body_ros.commands import ensemble as ensemble_command
from rigid_body_ros.commands.arguments import load_scene

#: Number of examples; a thorough run sets 20 000.
EXAMPLES = int(os.environ.get('FUZZ_EXAMPLES', '200'))
#: Numbers of examples for each kind of file that a user writes.
WRITTEN = [max(1, EXAMPLES // 9), *at_night(2000)]

#: Text to insert between words, or to replace words with.
SNIPPETS = [
    b'\0', b'\r', b'\t', b'\x1b[2J', b'"', b"'", b'\xff\xfe', b'\xed\xa0\x80', b'\xe9', b'\xc3',
    *(text.encode() for text in (
        '\ufeff', '\u2028', '\u0661', '\u00a0', '&a ', '*a', '<<: *a', '!!python/name:os.abort',
        '!!python/object/apply:os.abort []', '!!binary x', '!!timestamp 2020-13-45',
        '!!set {a, a}', '!!int x', '!!float .', '!', '!<tag:x>', '2020-13-45', '---\n',
        '2020-01-01T99:99:99',
        '%TAG ! x\n', '...\n', '? ', ': ', '- ', '{', '}', '[', ']', ',', '#', '|\n', '>\n', '@',
        '`', '~', 'null', 'true', '.inf', '-.inf', 'nan', 'snan', '1e9999999', '-1e-9999999', '0x',
        '0o7', '1_0', '1e', '.', '-', '../', '/etc/passwd', '..', '/dev/zero', ';', ' ', '\n',
        '\n\n', '\r\n', 'time_ms', 'tx (mNm)', 'ty [kN m]', 't_ns', 'time', 'mx', '(', ')',
        'NaN', '-Infinity', '1e999', '-1', '0', '1e300', '-1e300', '1e-320', '[]', '{}', '"x"',
        'null,', '9' * 400, '9' * 5000, '[' * 3000, '{a: ' * 3000, '- ' * 3000, '? ' * 3000,
        'x' * 70_000, 'a,' * 40_000, '1' * 70_000, LAUGHS, 'relative_file_paths: [..]\n',
        'inertia: 3\n', 'x: ' * 300))]


def words(data):
    """Return the spans of words, and of the space between them."""
    return [found.span() for found in re.finditer(rb'[^\s,:]+|[\s,:]+', data)] or [(0, len(data))]


def mutations(data):
    """Return a strategy of ways to change bytes."""
    place, word = st.integers(0, len(data)), st.sampled_from(words(data))
    snippet = st.sampled_from(SNIPPETS) | st.binary(max_size=4)
    spans = st.tuples(place, place).map(sorted).map(tuple)
    return st.one_of(
        st.tuples(word, snippet), st.tuples(word.map(lambda span: (span[0], span[0])), snippet),
        st.tuples(place.map(lambda at: (at, at)), snippet), st.tuples(spans, st.just(b'')),
        st.tuples(st.tuples(st.just(0), st.just(0)), snippet),
        st.tuples(st.tuples(st.just(len(data)), st.just(len(data))), snippet),
        # A copy of existing text, so that lines and keys occur twice.
        st.tuples(place.map(lambda at: (at, at)), spans.map(lambda span: data[slice(*span)])))


def mutated(data, changes, encoding):
    for (start, end), snippet in sorted(changes, reverse=True):
        data = data[:start] + snippet + data[end:]
    return data.decode(errors='replace').encode(encoding) if encoding else data


def check(target, seed, run, examples):
    """Run a function with a file replaced by its mutations from a seed."""
    target.write_bytes(seed)
    assert run() == ''

    @settings(max_examples=examples, database=None)
    @given(st.lists(mutations(seed), min_size=1, max_size=4),
           st.sampled_from([None] * 6 + ['utf-16', 'utf-8-sig', 'utf-32']))
    def examine(changes, encoding):
        content = mutated(seed, changes, encoding)
        target.write_bytes(content)
        run()
        assert target.read_bytes() == content
    examine()


URDF = "<robot name='a'><link name='b'><inertial><mass value='1'/><inertia ixx='1' ixy='0' " \
    "ixz='0' iyy='2' iyz='0' izz='2.5'/></inertial></link></robot>"
SCENES = {
    'tumbler': TUMBLER.read_text(),
    'iss': (CONFIG / 'iss.yaml').read_text(),
    'robot': f'/ns/attitude_node:\n  ros__parameters:\n    robot_description: "{URDF}"\n'
             '    qos_overrides: {/torque: {subscription: {depth: 5}}}\n'}


@pytest.mark.slow
@pytest.mark.parametrize('examples', WRITTEN)
@pytest.mark.parametrize('name', SCENES)
def test_a_mutated_scene_gives_a_scene_or_a_line(tmp_path, name, examples):
    recorded, path = tmp_path / 'torque.csv', tmp_path / 'scene.yaml'
    recorded.write_text('1,0,0,0\n2,0.1,0,0\n')
    check(path, SCENES[name].encode(), lambda: outcome(recorded, path), examples)


NAMES = ('inertia.ixx', *(f'initial_attitude.{axis}' for axis in 'xyz'), 'torque_bias.z')
UNITS = ('kg m^2', 'rad', 'rad', 'rad', 'N m')
FIT = {'estimates': {name: {'value': value, 'unit': unit, 'identifiable': True}
                     for name, unit, value in zip(NAMES, UNITS, (0.02, 0.1, -0.2, 0.3, 1e-5))},
       'guess_attitude_xyzw': [0.5, -0.5, 0.5, 0.5],
       'covariance': {'names': NAMES, 'units': UNITS,
                      'matrix': (1e-8 * (np.eye(5) + 0.5)).tolist()},
       'window_s': 3.0, 'converged': True, 'verdict': {'level': 'explained'}}
VARIED = {
    'fitted.json': json.dumps(FIT, indent=1),
    'vary.yaml': 'inertia: {relative: 0.05}\ninitial_attitude: {tilt: 0.02}\n'
                 'initial_angular_velocity.y: {uniform: [0.5, 0.7]}\n'
                 'torque_gain:\n  normal: 0.03\n  relative: true\n'
                 'torque_noise: {normal: 1e-4}\nclock_offset: {normal: 0.01}\n'
                 'damping.dxx: {uniform: [0.0, 1e-3]}\n'}


def dispersed(path, scene, recorded):
    """Return the error line of a command that computes three runs; '' if there is none."""
    def run():
        options = ensemble_command.attitude_ensemble.parsed([
            '--scene', str(scene), '--recording', str(recorded), '--vary', str(path), '--runs',
            '3', '-o', str(path.parent / 'out')])
        rows = ensemble_command._ensemble(options, load_scene(options), ()).rows(0, 3)
        assert {*rows['status']} <= {'ok', 'failed'}
        return 0
    return line_of(run, 'attitude_ensemble')


@pytest.mark.slow
@pytest.mark.parametrize('examples', WRITTEN)
@pytest.mark.parametrize('name', VARIED)
def test_mutated_distributions_give_runs_or_a_line(tmp_path, name, examples):
    recorded, scene, path = (tmp_path / part for part in ('torque.csv', 'scene.yaml', name))
    recorded.write_text('1,0,0,0\n2,0.1,0,0\n')
    scene.write_text('/**:\n  ros__parameters:\n    inertia: {ixx: 0.02, iyy: 0.03, izz: 0.04}\n')
    check(path, VARIED[name].encode(), lambda: dispersed(path, scene, recorded), examples)


@pytest.mark.parametrize('text', [LAUGHS, *(start * 10 ** 6 for start in ('[', '{"a":', '- '))],
                         ids=['aliases', 'lists', 'groups', 'items'])
@pytest.mark.parametrize('name', ['scene.yaml', *VARIED])
def test_bombs_are_one_line(tmp_path, name, text):
    path = tmp_path / name
    path.write_text(text)
    line = dispersed(path, TUMBLER, tmp_path / 'none') if name in VARIED else outcome(
        tmp_path / 'none', path)
    assert f'{path}: expected ' in line


ROWS = ''.join(f'{k}.{k:09},{0.1 * k!r},-1e-{k},{k}\n' for k in range(1, 9))
TEXTS = {'bare': ROWS, 'named': f'time,tx,ty,tz\n{ROWS}',
         'units': 'tx (mN m),t_us,"status",ty [kNm],torque.z\r\n1,2,ok,3,4\r\n1,3,,3,4\r\n'}


@pytest.mark.slow
@pytest.mark.parametrize('name', TEXTS)
def test_mutated_text_gives_torques_or_a_line(tmp_path, name):
    path = tmp_path / 'torque.csv'
    check(path, TEXTS[name].encode(), lambda: outcome(path), max(1, EXAMPLES // 9))


@pytest.mark.slow
@pytest.mark.parametrize('kind', ['rosbags', 'ours'])
def test_a_mutated_description_gives_torques_or_a_line(tmp_path, kind):
    path = tmp_path / 'bag'
    if kind == 'rosbags':
        bags.split(tmp_path, bags.traffic(bags.torques(20)[6:]), parts=2)
    else:
        write_torques(path, [(1, '', [1.0, 0.0, 0.0])], kind=recording.FolderWriter)
    about = path / 'metadata.yaml'
    check(about, about.read_bytes(), lambda: outcome(path), max(1, EXAMPLES // 6))
