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

"""The page of a motion in a browser: its contents, its controls, and no network."""

import re
import shlex

import browser
from conftest import CONFIG, EPOCH_NS, limit_trades, RECORDINGS, SECOND, write_torques
import numpy as np
import pytest
from rigid_body_ros import messages, read, recording
from rigid_body_ros.commands import main
from rigid_body_ros.mechanics import so3
from rigid_body_ros.report.page import write
from rigid_body_ros.report.panels import Drawn, quantity_panels
from rigid_body_ros.report.report import Report

TUMBLER = (str(RECORDINGS / 'tumbler.mcap'), '--scene', str(CONFIG / 'tumbler.yaml'))
FREE = RECORDINGS / 'torque_free_asymmetric'
#: s; duration of the recording of the tumbler.
DURATION = 60.0


@pytest.fixture(scope='module')
def chromium():
    with browser.started() as found:
        yield found


@pytest.fixture(scope='module')
def path(tmp_path_factory):
    return reported(tmp_path_factory.mktemp('page') / 'page.html', *TUMBLER)


@pytest.fixture
def page(chromium, path):
    with browser.opened(chromium, path) as found:
        yield found


@pytest.fixture(scope='module')
def others(tmp_path_factory):
    """Return the pages of the other commands, by name."""
    folder = tmp_path_factory.mktemp('others')
    motion, vary = folder / 'motion.mcap', folder / 'vary.yaml'
    vary.write_text('torque_gain: {normal: 0.03}\n')
    assert main.attitude_replay([*TUMBLER, '-o', str(motion), '--also', 'input']) == 0
    commands = {'compare': [motion, '--measured', '/attitude', '--horizon', 2, '--horizon', 10],
                'tradeoff': ['--recording', TUMBLER[0]],
                'identify': [motion, '--measured', '/attitude', '-o', folder / 'fitted.yaml'],
                'ensemble': ['--recording', TUMBLER[0], '--vary', vary, '--runs', 50, '--times', 1,
                             '-o', folder / 'runs']}
    with pytest.MonkeyPatch.context() as monkeypatch:
        limit_trades(monkeypatch)
        for name, arguments in commands.items():
            assert getattr(main, f'attitude_{name}')([*map(str, (
                *arguments, *TUMBLER[1:], '--report', folder / f'{name}.html'))]) == 0, name
    return {name: folder / f'{name}.html' for name in commands}


def reported(path, *arguments):
    assert main.attitude_replay([*map(str, arguments), '--report', str(path)]) == 0
    return path


def attitudes(seconds):
    """Return the attitudes of the tumbler that the library computes."""
    problem = read(TUMBLER[0], TUMBLER[2])
    times = problem.start.time_ns + np.round(np.array(seconds) * 1e9).astype(np.int64)
    order = np.argsort(times)
    motion = problem.propagate(at=times[order])
    return motion.attitude[np.argsort(order)]


def cursors(page):
    """Return the position of the cursor in each chart, px, and the time of the body, s."""
    at = page.eval_on_selector_all('.cursor', 'lines => lines.map(one => one.getAttribute("x1"))')
    seconds = page.evaluate('motion.shown().time')
    assert page.text_content('#clock') == f'{seconds:.2f} s'
    return [*map(float, at)], seconds


def times_shown(page):
    """Return the labels on the time axis of each chart."""
    return page.eval_on_selector_all('.plot', """plots => plots.map(plot =>
        Array.from(plot.querySelectorAll('text[text-anchor=middle]'), one => one.textContent))""")


@pytest.mark.parametrize(('name', 'scene', 'headline'), [
    ('tumbler', CONFIG / 'tumbler.yaml',
     '10 times in 60 s, spins up from 0.63 to 1.5 rad/s and ends at 0.95 rad/s'),
    ('torque_free_intermediate_axis', None, '16 times in 100 s at 1 to 1.2 rad/s'),
    ('torque_free_symmetric_top', None, '19 times in 60 s at 2 rad/s'),
    ('constant_body_torque', None, 'by 0 rad in 0 s at 0.24 rad/s')])
def test_the_first_line_says_what_happened_and_numbers_are_rounded(tmp_path, name, scene,
                                                                   headline):
    path = RECORDINGS / f'{name}.mcap'
    text = reported(tmp_path / 'page.html', path, '--scene', scene or path.with_suffix('.yaml'),
                    '--rate', 10).read_text(encoding='utf-8')
    visible = text.split('<body>')[1].split('<script')[0]
    assert visible.startswith(f'\n<h1>The body turns {headline}</h1>')
    story = visible.split('<dl id="story">')[1].split('</dl>')[0]
    digits = [number.replace('.', '').lstrip('0') for number in re.findall(r'\d+\.\d+', story)]
    assert max(map(len, digits)) <= 4, story
    assert 'kg m²' in story
    assert 'm^2' not in visible


@pytest.mark.slow
def test_ten_attitudes_are_those_of_the_trajectory(page):
    chosen = np.random.default_rng(1).uniform(0.0, DURATION, 10).tolist()
    shown = [page.evaluate('time => { motion.set(time); return motion.shown(); }', time)
             for time in chosen]
    times = [state['time'] for state in shown]
    np.testing.assert_allclose(times, chosen, rtol=0.0, atol=0.011)  # 1 s if between torques
    apart = so3.angle_between(np.array([state['attitude'] for state in shown]), attitudes(times))
    assert apart.max() < 1e-8  # interpolation of lower order: 1e-7


@pytest.mark.slow
def test_play_moves_the_body_and_the_space_key_stops_it(page):
    still = page.locator('#body').screenshot()
    page.click('#play')
    page.evaluate("""new Promise(resolve => {
        const look = () => motion.shown().time > 0.3 ? resolve() : requestAnimationFrame(look);
        look();
    })""")
    page.evaluate('document.activeElement.blur()')
    page.keyboard.press('Space')
    assert page.get_attribute('#play', 'aria-pressed') == 'false'
    stopped = page.evaluate('motion.shown()')
    assert page.locator('#body').screenshot() != still
    page.evaluate('new Promise(resolve => setTimeout(resolve, 100))')
    assert page.evaluate('motion.shown()') == stopped
    np.testing.assert_array_less(so3.angle_between(
        np.array(stopped['attitude']), attitudes([stopped['time']])), 1e-6)


@pytest.mark.slow
def test_the_slider_and_a_click_into_a_chart_move_the_cursor_of_every_chart(page):
    before, _ = cursors(page)
    page.focus('#time')
    page.keyboard.press('End')
    end, seconds = cursors(page)
    assert (len(set(end)), seconds) == (1, DURATION)
    page.keyboard.press('Home')
    start, seconds = cursors(page)
    assert (start, seconds) == (before, 0.0)
    page.keyboard.press('ArrowRight')
    between, seconds = cursors(page)
    assert 0.0 < seconds < DURATION
    np.testing.assert_allclose(between, start[0] + (end[0] - start[0]) * seconds / DURATION)
    plot = page.locator('.plot').nth(2)
    width = plot.bounding_box()['width']
    plot.click(position={'x': 0.5 * width, 'y': 50})
    at, seconds = cursors(page)
    assert 0.4 * DURATION < seconds < 0.6 * DURATION
    np.testing.assert_allclose(at, 0.5 * width, atol=1.0)


@pytest.mark.slow
def test_zoom_in_one_chart_zooms_all(page):
    whole = times_shown(page)
    assert len(whole) == 4
    assert whole[0][:2] == ['0', '5'], whole[0]
    plot = page.locator('.plot').nth(1)
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()
    page.mouse.move(box['x'] + 300, box['y'] + 60)
    page.mouse.down()
    page.mouse.move(box['x'] + 400, box['y'] + 90, steps=3)
    page.mouse.up()
    zoomed = times_shown(page)
    assert zoomed[0] != whole[0]
    assert zoomed == 4 * [zoomed[0]]
    first, last = float(zoomed[0][0]), float(zoomed[0][-2])  # the last is the label of the axis
    assert 10.0 < first < last < 22.0
    page.dblclick('.plot >> nth=3')
    assert times_shown(page) == whole


def brightness(colour):
    return max(map(int, re.findall(r'\d+', colour)[:3]))


@pytest.mark.slow
@pytest.mark.parametrize(('scheme', 'width'), [('light', 390), ('dark', 1280)])
def test_a_page_fits_its_window_and_the_slider_stays_in_sight(chromium, path, scheme, width):
    with browser.opened(chromium, path, width, color_scheme=scheme) as page:
        assert page.evaluate('document.documentElement.scrollWidth') == width
        paper, ink = (page.evaluate(f'getComputedStyle(document.body).{name}')
                      for name in ('backgroundColor', 'color'))
        light, dark = (paper, ink) if scheme == 'light' else (ink, paper)
        assert brightness(light) > 200 > 50 > brightness(dark)
        body, facts = (page.locator(name).bounding_box() for name in ('#moving', '#facts'))
        if width > 1000:
            assert facts['x'] > body['x'] + body['width']
            assert facts['y'] == body['y']
        else:
            assert facts['y'] > body['y'] + 0.9 * body['height']
        for part in (0.0, 0.5, 0.8):
            page.evaluate('part => scrollTo(0, part * document.body.scrollHeight)', part)
            slider = page.locator('#time').bounding_box()
            assert 0.0 < slider['y'] < 900.0 - slider['height']
        height = page.evaluate("""() => {
            const canvas = document.getElementById('body'), {width: w, height: h} = canvas;
            const {data} = canvas.getContext('2d').getImageData(0, 0, w, h);
            const isDrawn = (y) => data.subarray(4 * w * y, 4 * w * (y + 1)).some(Boolean);
            const rows = Array.from({length: h}, (_, y) => y).filter(isDrawn);
            return (rows[rows.length - 1] - rows[0]) / Math.min(w, h);
        }""")
        assert 0.7 < height < 1.0  # the body fills its place


@pytest.mark.slow
@pytest.mark.parametrize('width', [390, 1280])
def test_a_table_of_estimates_is_not_cut(chromium, others, width):
    with browser.opened(chromium, others['identify'], width) as page:
        box, name = page.locator('main .wide-table'), page.locator('td:first-child').first
        left = name.bounding_box()['x']
        is_cut = box.evaluate('box => box.scrollWidth > box.clientWidth')
        assert is_cut == (width == 390)
        box.evaluate('box => box.scrollTo(box.scrollWidth, 0)')
        unit, around = page.locator('td:last-child').first.bounding_box(), box.bounding_box()
        assert unit['x'] + unit['width'] <= around['x'] + around['width'] + 1.0 <= width
        assert name.bounding_box()['x'] == pytest.approx(left, abs=1.0)


@pytest.mark.slow
def test_names_from_a_recording_stay_text(chromium, tmp_path):
    topic = '/</script><script>alert(1)</script>'
    name = '<img src=x onerror=alert(2)>.mcap'
    write_torques(tmp_path / name, [(EPOCH_NS + k * SECOND, '', (0.0, 0.0, 1e-3))
                                    for k in range(3)], topic)
    target = reported(tmp_path / 'page.html', tmp_path / name, *TUMBLER[1:], '--topic', topic)
    with browser.opened(chromium, target) as page:
        assert page.text_content('.source') == f'{name}: {topic}'
        assert shlex.quote(topic) in page.text_content('footer')
        assert page.locator('script').count() == 3
        assert page.locator('img').count() == 0
        assert str(tmp_path) not in page.content()


@pytest.mark.slow
def test_the_ellipsoid_is_shown_for_a_motion_without_torque(chromium, path, tmp_path):
    free = reported(tmp_path / 'free.html', f'{FREE}.mcap', '--scene', f'{FREE}.yaml')
    for target, visible in ((path, False), (free, True)):
        with browser.opened(chromium, target) as page:
            assert page.is_visible('#poinsot') == visible


@pytest.mark.parametrize('count', [
    pytest.param(60_000, marks=pytest.mark.slow), pytest.param(3_600_000,
                                                               marks=pytest.mark.nightly)])
def test_a_spike_of_one_sample_is_visible(chromium, tmp_path, count):
    # Torques of 1 mN m at 1 kHz, with one sample of 1 N m.
    torques, spike = np.full((count, 6), 1e-3), int(0.637 * count)
    torques[spike, 3], seconds = 1.0, 1e-3 * spike
    with recording.Writer(tmp_path / 'spike.mcap') as writer:
        writer.add_topic('/torque', messages.WRENCH)
        writer.write_columns(EPOCH_NS + np.arange(count) * 1_000_000,
                             [recording.Column('/torque', '', torques)])
    target = reported(tmp_path / 'page.html', tmp_path / 'spike.mcap', *TUMBLER[1:])
    assert target.stat().st_size < 8e6
    with browser.opened(chromium, target) as page:
        x, y = np.reshape(page.evaluate("""() => {
            const plots = document.querySelectorAll('.plot');
            return plots[plots.length - 1].querySelector('.curve').getAttribute('d')
                .split(/[ MLml]+/).filter(Boolean).map(Number);
        }"""), (-1, 2)).T
        assert np.ptp(y) > 100.0
        left, right = x.min(), x.max()
        assert np.count_nonzero(y < y.max() - 1.0) <= 4
        shown = (x[y.argmin()] - left) / (right - left) * 1e-3 * count
        assert shown == pytest.approx(seconds, abs=2e-3 * count / (right - left))
        output = page.locator('.panel').last.locator('output').first
        readings = set()
        for intervals in (-1, 0, 1):  # the cursor stands at samples of the body
            page.evaluate('time => motion.set(time)', seconds + intervals * 1e-3 * count / 8192)
            readings.add(output.text_content())
        assert '0.0010 to 1.0000' in readings


@pytest.mark.slow
@pytest.mark.parametrize('name', ['compare', 'tradeoff', 'identify', 'ensemble'])
def test_the_pages_of_other_commands_open_alone_and_fit_the_window(chromium, others, name):
    with browser.opened(chromium, others[name], 390) as page:
        assert page.evaluate('document.documentElement.scrollWidth') == 390
        assert page.locator('svg').count() > 0
        if name == 'tradeoff':  # a point spells out its setting
            point = page.locator('circle[tabindex="0"]').first
            text = point.get_attribute('aria-label')
            assert re.match(r'(auto|taylor|rk4|strang|explicit_euler): .*rad', text)
            point.focus()
            assert text in page.text_content('body')


@pytest.mark.slow
def test_the_percentiles_and_the_histogram_of_an_ensemble_are_filled(chromium, others):
    with browser.opened(chromium, others['ensemble']) as page:
        names = page.locator('.panel').nth(0).locator('.legend span').all_text_contents()
        assert names == ['5 % to 95 % ', '25 % to 75 % ', 'median ']
        outer, inner, runs = (
            np.reshape(re.findall(r'[\d.]+', path.get_attribute('d')), (-1, 2)).astype(float)
            for path in page.locator('.plot path.band').all())
        assert np.ptp(outer[:, 1]) > np.ptp(inner[:, 1]) > 50.0
        bottom = runs[:len(runs) // 2, 1]
        assert np.ptp(bottom) == 0.0
        assert runs[:, 1].max() == bottom[0]
        fills = page.eval_on_selector_all('.plot path.band', """paths =>
            paths.map(path => getComputedStyle(path).fill)""")
        assert 'none' not in fills


@pytest.mark.slow
def test_the_measured_body_is_an_outline_that_follows_the_time(chromium, others):
    with browser.opened(chromium, others['compare']) as page:
        assert 'the measured body' in page.text_content('#arrows')
        distance = page.evaluate("""() => [0, 0.5, 1].map((part) => {
            motion.set(part * motion.end);
            const scene = motion.scene, times = scene.ghost.times, now = scene.state.time;
            const i = times.reduce((best, time, k) =>
                Math.abs(time - now) < Math.abs(times[best] - now) ? k : best, 0);
            const measured = scene.ghost.attitudes.subarray(4 * i, 4 * i + 4);
            return Math.abs(scene.state.attitude.reduce((sum, v, k) => sum + v * measured[k], 0));
        })""")
        assert np.abs(np.array(distance) - 1.0).max() < 1e-6
        assert page.locator('path.curve.broad').count() > 0


@pytest.mark.slow
def test_outliers_are_crosses_and_gaps_are_not_joined(chromium, tmp_path):
    times_ns = np.arange(1000) * 10_000_000
    times_ns[600:] += 3 * 10 ** 9
    errors = np.random.default_rng(1).standard_normal((1000, 3))
    errors[300] = 100.0
    inliers = np.arange(1000) != 300
    _, panel = quantity_panels('sensor', 'body axes', Drawn(times_ns, inliers), errors, errors,
                               ('errors', errors), ('band', 2.0), 0)
    write(tmp_path / 'page.html', Report('outliers', '', [], [panel]))
    with browser.opened(chromium, tmp_path / 'page.html') as page:
        paths = {kind: [page.locator(f'.plot path.{kind}').nth(k).get_attribute('d')
                        for k in range(page.locator(f'.plot path.{kind}').count())]
                 for kind in ('line', 'marks', 'limits')}
        assert [one.count('M') for one in paths['line']] == [2, 2, 2]
        assert [one.count('m -6 0') for one in paths['marks']] == [1, 1, 1]
        assert [one.count('M') for one in paths['limits']] == [2]
        labels = page.locator('.plot text[text-anchor=end]').all_text_contents()
        assert max(float(text.replace('−', '-')) for text in labels) < 10.0
