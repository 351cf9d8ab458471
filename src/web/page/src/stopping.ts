// Stop: brakes at once, and drops the job when the machine is at rest, so that its position stays true.
import { REALTIME, type Sender, type Status } from "./sender";

/** Beyond the time that the slowest axis needs to brake, ms. */
const MARGIN = 500;
/** How often the machine is asked while it brakes, ms. */
const ASK = 50;

export class Stopping {
  private timer?: ReturnType<typeof setTimeout>;
  private asking?: ReturnType<typeof setInterval>;

  /** `done` is told whether the machine was at rest when it was reset. */
  constructor(private readonly sender: Sender, longest: number, private readonly done: (atRest: boolean) => void) {
    sender.realtime(REALTIME.hold);
    this.timer = setTimeout(() => this.reset(false), longest * 1000 + MARGIN);
    this.asking = setInterval(() => sender.realtime(REALTIME.status), ASK);
  }

  /** A report came: at rest, the machine is reset. */
  report({ state }: Status): void {
    if (/^(Hold:0|Idle|Door:[01]|Alarm|Sleep|Check)/.test(state)) this.reset(true);
  }

  /** Pressed again: reset now, wherever the machine is. */
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

/** Seconds that the slowest axis needs to brake from its greatest speed, by the settings of the machine. */
export function brakingTime(settings: Record<string, number>, axes: number): number {
  const times = Array.from({ length: axes }, (_, axis) => (settings[110 + axis] ?? 0) / 60 / (settings[120 + axis] || Infinity));
  return Math.max(0, ...times);
}
