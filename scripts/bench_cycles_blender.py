"""Runs Blender in a process of its own and asks it for renderings. Shared by bench_cycles and bench_bake; the side
inside Blender is bench_cycles_render.py."""
import json, os, shutil, subprocess, sys


class Blender:
    def __init__(self, job, *options):
        environment = dict(os.environ, PATH='/usr/bin:/bin')  # a Python found along PATH would become Blender's own
        self.process = subprocess.Popen([shutil.which('blender'), '-b', '--factory-startup', '-noaudio', *options,
                                         '--python-exit-code', '1',
                                         '--python', 'scripts/bench_cycles_render.py', '--', json.dumps(job)],
                                        env=environment,
                                        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                                        text=True, errors='replace')
        self.answer()

    def answer(self):
        """What follows BENCH, and the lines on the way there."""
        said = []
        for line in self.process.stdout:
            if line.startswith('BENCH '):
                return line.split()[1], said
            said.append(line)
        sys.exit('%s: Blender ended:\n' % os.path.basename(sys.argv[0]) + ''.join(said[-20:]))

    def run(self, samples, seed, path):
        """Returns the seconds that it took, and what Blender said; path: of the file that is written."""
        self.process.stdin.write('%d %d %s\n' % (samples, seed, os.path.abspath(path)))
        self.process.stdin.flush()
        seconds, said = self.answer()
        return float(seconds), said

    def close(self):
        self.process.stdin.close()
        self.process.wait()


def share_cores():
    """Has sbl's tools use the cores that Blender does, by a software renderer; how many."""
    os.environ.setdefault('LIBGL_ALWAYS_SOFTWARE', '1')
    return int(os.environ.setdefault('LP_NUM_THREADS', str(len(os.sched_getaffinity(0)))))
