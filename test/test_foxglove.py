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

"""Foxglove's reader reads the outputs of this package to the last bit."""

import shutil
import subprocess

from conftest import CONFIG, RECORDINGS
import pytest
from rigid_body_ros import messages, scene
from rigid_body_ros.replay import replay

SCRIPT = r"""
const fs = require('fs/promises');
const {McapIndexedReader} = require('@mcap/core');
const {decompress} = require('fzstd');
async function main() {
  const file = await fs.open(process.argv[2]);
  const readable = {
    size: async () => BigInt((await file.stat()).size),
    read: async (offset, length) => {
      const bytes = Buffer.alloc(Number(length));
      await file.read(bytes, 0, bytes.length, Number(offset));
      return bytes;
    },
  };
  const zstd = (bytes, size) => decompress(bytes, new Uint8Array(Number(size)));
  const reader = await McapIndexedReader.Initialize({readable, decompressHandlers: {zstd}});
  for await (const message of reader.readMessages()) {
    const channel = reader.channelsById.get(message.channelId);
    console.log(channel.topic, String(message.logTime), Buffer.from(message.data).toString('hex'));
  }
}
main();
"""


@pytest.mark.slow
def test_foxgloves_reader_gives_the_same_bytes(tmp_path):
    npm = shutil.which('npm')
    if npm is None:
        pytest.skip('node is not installed')
    command = [npm, 'install', '--no-fund', '@mcap/core@2', 'fzstd']
    installed = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True,
                               timeout=120)
    if installed.returncode:
        pytest.skip(f'npm cannot install @mcap/core: {installed.stderr[-200:]}')
    loaded = scene.load(CONFIG / 'tumbler.yaml')
    replay(RECORDINGS / 'tumbler.mcap', loaded, tmp_path / 'motion.mcap')
    motion = replay(RECORDINGS / 'tumbler.mcap', loaded).trajectory
    (tmp_path / 'read.js').write_text(SCRIPT)
    printed = subprocess.run(['node', 'read.js', 'motion.mcap'], cwd=tmp_path, check=True,
                             capture_output=True, text=True).stdout
    found = [line.split() for line in printed.splitlines()]
    for topic, kind, frame, values in (
            ('/attitude', messages.QUATERNION, 'world', motion.attitude),
            ('/euler_angles', messages.VECTOR3, 'world', motion.euler_angles('ZXZ')),
            ('/angular_velocity', messages.VECTOR3, 'base_link', motion.angular_velocity)):
        assert [line[1:] for line in found if line[0] == topic] == [
            [str(stamp_ns), kind.encode(stamp_ns, frame, row).hex()]
            for stamp_ns, row in zip(motion.times_ns.tolist(), values)]
