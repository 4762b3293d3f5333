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

"""The layouts for Foxglove, rviz2 and PlotJuggler show the topics that a replay writes."""

import json
from operator import attrgetter
import re
import xml.etree.ElementTree as ElementTree

from conftest import CONFIG, RECORDINGS, ROOT
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
import pytest
from rigid_body_ros import messages, scene
from rigid_body_ros.replay import replay
import yaml

#: Vectors to plot: the topic, the vector in it, and its unit.
PLOTS = [('/euler_angles', 'vector', 'rad'), ('/angular_velocity', 'vector', 'rad/s'),
         ('/torque', 'wrench/torque', 'N m')]
MARKER = 'visualization_msgs/msg/Marker'
#: Topics that only the node has, because a replay writes no odometry. Their names are relative,
#: because view.launch.py gives rviz2 the namespace of the node.
LIVE = {'odometry': messages.ODOMETRY.name}
#: The topics that each display of rviz2 subscribes to.
DISPLAYS = {'rviz_default_plugins/Marker': MARKER,
            'rviz_default_plugins/Odometry': messages.ODOMETRY.name}


class Written(dict):
    """The first message of each topic, with the name of its type."""

    def topics(self, kind):
        return sorted(topic for topic, (found, _) in self.items() if found == kind)


@pytest.fixture(scope='module')
def written(tmp_path_factory):
    path, found = tmp_path_factory.mktemp('layouts') / 'motion.mcap', Written()
    replay(RECORDINGS / 'tumbler.mcap', scene.load(CONFIG / 'tumbler.yaml'), path,
           also=('imu', 'tf', 'markers', 'input'))
    with open(path, 'rb') as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for topic in {channel.topic for channel in reader.get_summary().channels.values()}:
            schema, _, _, message = next(reader.iter_decoded_messages([topic]))
            found[topic] = schema.name, message
    return found


@pytest.fixture
def transform(written):
    _, message = written['/tf']
    return message.transforms[0]


def foxglove():
    return json.loads((CONFIG / 'foxglove.json').read_bytes())


def foxglove_panels(kind):
    return [panel for name, panel in foxglove()['configById'].items()
            if name.startswith(f'{kind}!')]


def foxglove_plots():
    return {panel['yAxisLabel']: [path['value'] for path in panel['paths'] if path['enabled']]
            for panel in foxglove_panels('Plot')}


def plotjuggler():
    return ElementTree.parse(CONFIG / 'plotjuggler.xml').getroot()


def plotjuggler_plots():
    return {area.get('name'): [curve.get('name') for curve in area.iter('curve')]
            for area in plotjuggler().iter('DockArea')}


def rviz():
    return yaml.safe_load((CONFIG / 'rviz.rviz').read_bytes())['Visualization Manager']


def rviz_displays(kind):
    return [display for display in rviz()['Displays']
            if display['Class'] == f'rviz_default_plugins/{kind}' and display['Enabled']]


each_plotter = pytest.mark.parametrize(('plots', 'separator'), [
    (foxglove_plots, '.'), (plotjuggler_plots, '/')], ids=['foxglove', 'plotjuggler'])


@each_plotter
def test_every_curve_is_a_number_that_a_replay_writes(written, plots, separator):
    for curve in (curve for plot in plots().values() for curve in plot):
        topic = max((one for one in written if curve.startswith(one + separator)), key=len)
        field = attrgetter(curve[len(topic) + 1:].replace(separator, '.'))
        assert isinstance(field(written[topic][1]), float), curve


@each_plotter
def test_angles_rates_and_torques_are_plotted_with_their_units(plots, separator):
    found = plots()
    assert list(found.values()) == [
        [separator.join((topic, *vector.split('/'), axis)) for axis in 'xyz']
        for topic, vector, _ in PLOTS]
    assert [re.search(r'\((.*)\)$', label)[1] for label in found] == [unit for *_, unit in PLOTS]


def test_foxglove_plots_over_the_stamps_and_tells_the_curves_apart():
    for panel in foxglove_panels('Plot'):
        assert {path['timestampMethod'] for path in panel['paths']} == {'headerStamp'}
        assert panel['xAxisVal'] == 'timestamp'
        assert panel['showLegend']
        for key in ('label', 'color'):
            assert len({path[key] for path in panel['paths']}) == 3


def test_foxglove_shows_the_markers_and_the_frames(written, transform):
    panel, = foxglove_panels('3D')
    shown = sorted(topic for topic, settings in panel['topics'].items() if settings['visible'])
    assert shown == written.topics(MARKER) != []
    frames = {f'frame:{transform.header.frame_id}', f'frame:{transform.child_frame_id}'}
    assert {name for name, settings in panel['transforms'].items()
            if settings['visible']} == frames
    assert panel['followTf'] == transform.header.frame_id
    assert [layer['layerId'] for layer in panel['layers'].values()] == ['foxglove.Grid']


def test_foxglove_has_a_place_for_every_panel():
    def placed(node):
        return [node] if isinstance(node, str) else placed(node['first']) + placed(node['second'])
    layout = foxglove()
    assert sorted(placed(layout['layout'])) == sorted(layout['configById'])


def test_plotjuggler_finds_as_many_plots_as_are_announced():
    # If there are fewer sizes than the count says, PlotJuggler reads beyond the last.
    for splitter in plotjuggler().iter('DockSplitter'):
        assert int(splitter.get('count')) == len(splitter)
        assert len(splitter.get('sizes').split(';')) == len(splitter)


@pytest.mark.slow
def test_rviz_subscribes_to_what_is_there_by_the_right_types(written):
    types = {**{topic: kind for topic, (kind, _) in written.items()}, **LIVE}
    for display in rviz()['Displays']:
        if 'Topic' in display:
            assert types[display['Topic']['Value']] == DISPLAYS[display['Class']]


def test_rviz_shows_the_markers_the_frames_and_the_attitude_of_the_node(written, transform):
    shown = sorted(display['Topic']['Value'] for display in rviz_displays('Marker'))
    assert shown == written.topics(MARKER) != []
    assert [display['Topic']['Value'] for display in rviz_displays('Odometry')] == [*LIVE]
    assert len(rviz_displays('TF')) == len(rviz_displays('Grid')) == 1
    assert rviz()['Global Options']['Fixed Frame'] == transform.header.frame_id


def test_the_launch_file_opens_the_layout_of_rviz_whose_view_the_mouse_turns():
    text = (ROOT / 'launch' / 'view.launch.py').read_text()
    assert re.findall(r"'config', '(.*)'", text) == ['rviz.rviz']
    # rviz2 removes tools that a file does not list.
    assert {'Class': 'rviz_default_plugins/MoveCamera'} in rviz()['Tools']
