"""Runs Blender as a child process that renders on request, for bench_cycles and bench_bake. Blender runs
bench_cycles_render.py."""
import json, os, shutil, subprocess, sys


class Blender:
    def __init__(self, job, *options):
        environment = dict(os.environ, PATH='/usr/bin:/bin')  # otherwise Blender might use another Python from PATH
        self.process = subprocess.Popen([shutil.which('blender'), '-b', '--factory-startup', '-noaudio', *options,
                                         '--python-exit-code', '1',
                                         '--python', 'scripts/bench_cycles_render.py', '--', json.dumps(job)],
                                        env=environment,
                                        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                                        text=True, errors='replace')
        self.answer()

    def answer(self):
        """Waits for a line "BENCH ...". Returns the text after BENCH, and the lines before it."""
        said = []
        for line in self.process.stdout:
            if line.startswith('BENCH '):
                return line.split()[1], said
            said.append(line)
        sys.exit('%s: Blender ended:\n' % os.path.basename(sys.argv[0]) + ''.join(said[-20:]))

    def run(self, samples, seed, path):
        """Returns the seconds, and the output of Blender. path: the file that Blender writes"""
        self.process.stdin.write('%d %d %s\n' % (samples, seed, os.path.abspath(path)))
        self.process.stdin.flush()
        seconds, said = self.answer()
        return float(seconds), said

    def close(self):
        self.process.stdin.close()
        self.process.wait()


def share_cores():
    """Makes the tools of sbl use a software renderer on the same cores as Blender. Returns the number of cores."""
    os.environ.setdefault('LIBGL_ALWAYS_SOFTWARE', '1')
    return int(os.environ.setdefault('LP_NUM_THREADS', str(len(os.sched_getaffinity(0)))))
