// Stop: brakes immediately, and resets the machine when it is at rest, so that its position stays valid.
import { REALTIME, type Sender, type Status } from "./sender";

/** Time for braking beyond the braking time of the slowest axis, ms. A machine that still moves after this time is
 * reset in motion. */
const MARGIN = 500;
/** Interval between status requests while the machine brakes, ms. */
const ASK = 50;

export class Stopping {
  private timer?: ReturnType<typeof setTimeout>;
  private asking?: ReturnType<typeof setInterval>;

  /** `longest`: braking time of the slowest axis, s. `done` is called after the reset, with `true` if the machine was
   * at rest. */
  constructor(private readonly sender: Sender, longest: number, private readonly done: (atRest: boolean) => void) {
    sender.realtime(REALTIME.hold);
    this.timer = setTimeout(() => this.reset(false), longest * 1000 + MARGIN);
    this.asking = setInterval(() => sender.realtime(REALTIME.status), ASK);
  }

  /** Handles a report: resets the machine if it is at rest. */
  report({ state }: Status): void {
    if (/^(Hold:0|Tool|Idle|Door:[01]|Alarm|Sleep|Check)/.test(state)) this.reset(true);
  }

  /** Call when Stop is pressed again: resets immediately, even in motion. */
  again(): void {
    this.reset(false);
  }

  cancel(): void {
    clearTimeout(this.timer);
    clearInterval(this.asking);
  }

  private reset(atRest: boolean): void {
    this.cancel();
    this.sender.reset();
    this.done(atRest);
  }
}

/** Returns the time in s that the slowest axis needs to brake from its maximum rate, by the machine's settings. */
export function brakingTime(settings: Record<string, number>, axes: number): number {
  const times = Array.from({ length: axes }, (_, axis) => (settings[110 + axis] ?? 0) / 60 / (settings[120 + axis] || Infinity));
  return Math.max(0, ...times);
}
