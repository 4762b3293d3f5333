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

"""Ensembles on the workers of a Dask scheduler: same bytes, nothing lost, one-line errors."""

from contextlib import contextmanager
from functools import partial
import os
import signal
import socket
import subprocess
import sys

import psutil
import pytest
from rigid_body_ros.commands import main
from rigid_body_ros.runtime import cluster
from test_ensemble import arguments, COMMAND, contents, count, ENVIRONMENT, inputs, run
from test_ensemble_folder import wait_for

inputs = inputs  # a fixture, used by its name
RUNS = 10_000
#: Even without a dashboard, Dask serves metrics, by default on all network interfaces.
LOCAL = ['--host', '127.0.0.1', '--dashboard-address', '127.0.0.1:0', '--no-dashboard']


@pytest.fixture(scope='module')
def started_cluster(tmp_path_factory):
    """Start a scheduler and two worker processes; return its file and their parent."""
    folder = tmp_path_factory.mktemp('dask')
    file = folder / 'scheduler.json'
    with started(folder, 'scheduler', '--port', '0', '--scheduler-file', file) as first, \
            started(folder, 'worker', '--scheduler-file', file, '--nworkers', '2', '--nthreads',
                    '1', '--local-directory', folder) as second:
        wait_for(file.exists)
        wait_for(lambda: len(workers(second)) == 2)
        for process in (first, second, *workers(second)):
            assert listening(process) == {'127.0.0.1'}
        yield file, second


@pytest.fixture
def scheduler(started_cluster):
    return started_cluster[0]


@contextmanager
def started(folder, kind, *options, script='from distributed.cli.dask_{} import main; main()'):
    command = [sys.executable, '-c', script.format(kind), *LOCAL, *map(str, options)]
    with open(folder / f'{kind}.log', 'w') as log, \
            subprocess.Popen(command, stdout=log, stderr=log, env=ENVIRONMENT) as process:
        try:
            yield psutil.Process(process.pid)
        finally:
            process.terminate()


def workers(nanny):
    """Return the processes that compute; another child only tracks system resources."""
    return [child for child in nanny.children() if listening(child)]


def listening(process):
    return {one.laddr.ip for one in process.net_connections('inet') if one.status == 'LISTEN'}


@pytest.fixture
def error_of(inputs, refusal):
    """Return a function that returns the error of an ensemble on a scheduler."""
    return lambda scheduler: refusal(
        'attitude_ensemble', *arguments(inputs, 'out', 10, '--scheduler', scheduler))


@contextmanager
def begun(inputs, scheduler, *more):
    """Start an ensemble in a process, and wait until it has some blocks but not all."""
    command = [*COMMAND, *arguments(inputs, 'out', RUNS, '--scheduler', scheduler, *more)]
    with subprocess.Popen(command, env=ENVIRONMENT, stdout=subprocess.DEVNULL,
                          stderr=subprocess.PIPE, text=True) as process:
        wait_for(lambda: count(inputs / 'out' / 'blocks') >= 3 or process.poll() is not None)
        assert process.poll() is None
        yield process


@pytest.mark.nightly
@pytest.mark.parametrize('more', [['--times', 5], []], ids=['motions', 'final'])
def test_a_worker_that_is_killed_changes_no_byte(inputs, started_cluster, more):
    scheduler, parent = started_cluster
    run(inputs, 'here', RUNS, *more)
    with begun(inputs, scheduler, *more) as process:
        os.kill(workers(parent)[0].pid, signal.SIGKILL)
        assert process.poll() is None
        _, error = process.communicate(timeout=300)
    assert (process.returncode, error) == (0, '')
    assert contents(inputs / 'out') == contents(inputs / 'here')


@pytest.mark.nightly
def test_an_interrupt_leaves_no_task_and_a_folder_that_is_resumed(inputs, scheduler):
    run(inputs, 'here', RUNS)
    with begun(inputs, scheduler) as process:
        process.send_signal(signal.SIGINT)
        _, error = process.communicate(timeout=60)
    assert process.returncode == 130
    assert error == ('attitude_ensemble: interrupted; run the same command again to continue in '
                     f'{inputs / "out"}\n')
    with cluster.connected(str(scheduler), print) as connection:
        wait_for(lambda: not connection.client.run_on_scheduler(tasks))
    run(inputs, 'out', RUNS, '--scheduler', scheduler)
    assert contents(inputs / 'out') == contents(inputs / 'here')


def tasks(dask_scheduler):
    return len(dask_scheduler.tasks)


@pytest.mark.slow
def test_every_item_is_computed_once_and_errors_are_raised(scheduler):
    with cluster.connected(str(scheduler), pytest.fail) as connection:
        assert sorted(connection.results(abs, range(-50, 0))) == [*range(1, 51)]
        with pytest.raises(TypeError, match='bad operand'):
            [*connection.results(abs, [1, '2'])]


@pytest.mark.slow
def test_what_kills_every_worker_ends(scheduler):
    with cluster.connected(str(scheduler), lambda text: None) as connection:
        found = connection.results(partial(os.execv, '/bin/false'), [['false']],
                                   lambda item, error: [*item, str(error)])
        assert [*found] == [['false', '4 workers died one after the other; '
                             'their logs may have the reason']]
        assert [*connection.results(abs, [-1])] == [1]


@pytest.mark.slow
def test_other_versions_are_rejected(scheduler, error_of, monkeypatch):
    versions = cluster._versions()
    monkeypatch.setattr(cluster, '_versions', lambda: {**versions, 'numpy': '0.1'})
    assert (f'{socket.gethostname()}: expected the versions of this command, numpy 0.1, found '
            f'{versions["numpy"]}') in error_of(scheduler)


@pytest.mark.slow
def test_a_worker_is_no_scheduler(scheduler, error_of):
    with cluster.connected(str(scheduler), print) as connection:
        worker = next(iter(connection.client.nthreads()))
    assert f'{worker}: expected a Dask scheduler, found a worker' \
        in error_of(worker)


@pytest.mark.slow
def test_a_worker_without_the_package_survives(error_of, tmp_path):
    file = tmp_path / 'scheduler.json'
    script = ("import sys; sys.modules['rigid_body_ros'] = None; "
              'from distributed.cli.dask_{} import main; main()')
    with started(tmp_path, 'scheduler', '--port', '0', '--scheduler-file', file, script=script), \
            started(tmp_path, 'worker', '--scheduler-file', file, '--nthreads', '1', '--no-nanny',
                    '--local-directory', tmp_path, script=script) as worker:
        wait_for(file.exists)
        wait_for(lambda: listening(worker))
        assert 'a worker cannot import what it needs of rigid_body_ros' \
            in error_of(file)
        assert worker.is_running()


@pytest.mark.nightly
def test_workers_may_join_later(inputs, tmp_path):
    file = tmp_path / 'scheduler.json'
    command = [*COMMAND, *arguments(inputs, 'out', 10, '--scheduler', file)]
    with started(tmp_path, 'scheduler', '--port', '0', '--scheduler-file', file):
        wait_for(file.exists)
        with subprocess.Popen(command, env=ENVIRONMENT, stdout=subprocess.DEVNULL,
                              stderr=subprocess.PIPE, text=True) as process:
            assert process.stderr.readline() == \
                f'attitude_ensemble: note: {file}: no workers; waiting for one\n'
            with started(tmp_path, 'worker', '--scheduler-file', file, '--no-nanny',
                         '--local-directory', tmp_path):
                assert process.communicate(timeout=120)[1] == ''
    assert process.returncode == 0


@pytest.mark.parametrize(('text', 'message'), [
    (None, 'cannot read the scheduler file (an address is HOST:PORT or tcp://HOST:PORT): No such '
     'file or directory'),
    ('{', 'expected JSON, found an error'),
    ('{"address": 5}', 'address: expected one such as tcp://HOST:PORT, found 5'),
], ids=['missing', 'damaged', 'number'])
def test_bad_files(inputs, error_of, text, message):
    if text is not None:
        (inputs / 'scheduler.json').write_text(text)
    assert f'{inputs / "scheduler.json"}: {message}' \
        in error_of(inputs / 'scheduler.json')


@pytest.mark.slow
@pytest.mark.parametrize('listens', [False, True])
def test_nothing_replies_at_an_address(error_of, monkeypatch, listens):
    monkeypatch.setattr(cluster, '_PATIENCE', 0.2)
    with socket.create_server(('127.0.0.1', 0)) as silent:
        address = f'127.0.0.1:{silent.getsockname()[1]}'
        if not listens:
            silent.close()
        assert f'{address}: expected a Dask scheduler, found no reply within 0.2 s' \
            in error_of(address)
    assert "pigeon: cannot connect to a Dask scheduler: unknown address scheme 'carrier'" \
        in error_of('carrier://pigeon')


def test_threads_and_a_scheduler_exclude_each_other(inputs, capsys):
    with pytest.raises(SystemExit) as ended:
        main.attitude_ensemble(arguments(inputs, 'out', 10, '--workers', os.cpu_count(),
                                         '--scheduler', 'scheduler.json'))
    assert ended.value.code == 2
    assert 'not allowed with argument' in capsys.readouterr().err


@pytest.mark.slow
def test_only_the_option_imports_dask_and_says_if_it_is_missing(inputs):
    script = ("import sys; sys.modules['distributed'] = None; "
              'from rigid_body_ros.commands import main; '
              'given = sys.argv[1:]; assert main.attitude_ensemble(given) == 0; '
              "assert 'dask' not in sys.modules; "
              "sys.exit(main.attitude_ensemble([*given[:-1], 'other', '--scheduler', 'a:1']))")
    command = [sys.executable, '-c', script, *arguments(inputs, 'out', 10)]
    result = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, cwd=inputs,
                            check=False)
    assert result.returncode == 2
    assert result.stderr == ("attitude_ensemble: error: Python module 'distributed' is not "
                             'installed; run python3 -m pip install distributed\n')
