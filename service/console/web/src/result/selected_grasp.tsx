import type { ComponentChildren } from "preact";
import { useEffect, useRef } from "preact/hooks";
import type { Scan } from "../net/api";
import { mm, percent, plusMinus, pointText } from "../texts/format";
import { sentence } from "../texts/sentence";
import { SHAPES, type Tone } from "../texts/states";
import { findText, t } from "../texts/translate";
import { HintedEntry } from "../ui/hint";
import type { Chain, Grasp, Pose } from "../view3d/scene";
import { Copy } from "./tools/copy";
import { reveal, revealBeside } from "./reveal";
import type { Reach } from "./data/use_reach";

/** Recognition measures clearances only up to this distance. */
export const MAX_CLEARANCE_M = 0.03;

const SELECTED_GRASP = "selected-grasp";

/** A button to the details of the selected grasp, for a narrow screen, where they are far below the picture. */
export function ToSelectedGrasp({ id }: { id: number }) {
  const scroll = () => {
    const details = document.getElementById(SELECTED_GRASP);
    if (details !== null) reveal(details);
  };
  return (
    <p class="only-narrow">
      <button type="button" onClick={scroll}>
        {t("result.grasp.details", { id })}
      </button>
    </p>
  );
}

interface SelectedGraspProps {
  scan: Scan;
  grasp: Grasp;
  chain: Chain | undefined;
  reach: Reach;
  /** It was selected in the 3D view, so the list may have to scroll to it. */
  picked: boolean;
}

/** What to know about the selected grasp before it is carried out. */
export function SelectedGrasp({ scan, grasp, chain, reach, picked }: SelectedGraspProps) {
  const section = useRef<HTMLElement>(null);
  useEffect(() => {
    if (picked && section.current !== null) revealBeside(section.current);
  }, [picked]);
  const { T_base_grasp, T_base_flange, sigma_m, score } = grasp;
  const distances = distanceTexts(grasp);
  return (
    <section ref={section} id={SELECTED_GRASP} class="panel point" aria-label={t("result.grasp.region")}>
      <dl>
        <dt>{t("result.grasp.string")}</dt>
        <dd>{stringText(grasp, chain)}</dd>
        <dt>{t("result.grasp.reach")}</dt>
        <dd>
          <ReachText grasp={grasp} reach={reach} />
        </dd>
        <dt>{t("result.grasp.lift")}</dt>
        <dd>{liftTexts(grasp).map(({ tone, text }) => <Remark key={text} tone={tone}>{text}</Remark>)}</dd>
        <dt>{t("result.grasp.motion")}</dt>
        <dd>
          {t("result.grasp.motion_text", {
            down: mm(apart_m(T_base_flange.pregrasp, T_base_flange.grasp), 0),
            up: mm(apart_m(T_base_flange.grasp, T_base_flange.retreat), 0),
          })}
          {reach.sameGripper === false && <Remark tone="warn">{t("result.grasp.motion_other_gripper")}</Remark>}
        </dd>
        <dt>{t("result.grasp.clearance")}</dt>
        <dd>{clearanceText(grasp)}</dd>
        {distances.length > 0 && (
          <>
            <dt>{t("result.grasp.along")}</dt>
            <dd>{distances.map((text) => <span key={text} class="remark">{text}</span>)}</dd>
          </>
        )}
        <dt>{t("result.grasp.score")}</dt>
        <dd>{percent(score)}</dd>
        <dt>{t("result.point.position")}</dt>
        <dd>{pointText(positionOf(T_base_grasp))}</dd>
        <HintedEntry term="sigma" name={t("result.point.sigma")}>
          {plusMinus(sigma_m)}
        </HintedEntry>
      </dl>
      <div class="row">
        <Copy value={copyOf(scan, grasp, reach)} />
      </div>
    </section>
  );
}

/** Whether the arm can carry out the grasp, or why not. */
function ReachText({ grasp, reach: { grasps, failure } }: { grasp: Grasp; reach: Reach }) {
  if (failure !== null) return <>{t("result.grasp.reach_failed", { reason: failure.detail })}</>;
  if (grasps === null) return <>{t("result.grasp.reach_loading")}</>;
  const reach = grasps.get(grasp.id)?.reach ?? null;
  if (reach === null) return <>{t("result.grasp.reach_unknown")}</>;
  if (!reach.reachable) {
    const reason = findText(`result.grasp.reason.${reach.reason}`) ?? sentence(reach.message ?? "");
    return <Remark tone="warn">{t("result.grasp.not_reachable", { reason })}</Remark>;
  }
  if (reach.path_free === false) return <Remark tone="warn">{t("result.grasp.reachable_not_straight")}</Remark>;
  return <Remark tone="good">{t("result.grasp.reachable")}</Remark>;
}

function Remark({ tone, children }: { tone: Tone; children: ComponentChildren }) {
  return (
    <span class={`remark ${tone}`}>
      <span aria-hidden="true">{SHAPES[tone]}</span> {children}
    </span>
  );
}

function stringText({ chain: id, s_m }: Grasp, chain: Chain | undefined): string {
  if (chain === undefined) return t("viewer.label.at", { id, at: mm(s_m) });
  return t("result.grasp.string_at", { string: id, at: mm(s_m), length: mm(chain.length_m) });
}

function clearanceText({ clearance_m, table_clearance_m }: Grasp): string {
  const values = { beside: mm(clearance_m), below: mm(table_clearance_m) };
  return clearance_m >= MAX_CLEARANCE_M ? t("result.grasp.clearance_far", values) : t("result.grasp.clearance_near", values);
}

/** Say how far ends and crossings are along the string. */
function distanceTexts({ end_distance_m, over_distance_m, under_distance_m }: Grasp): string[] {
  const texts: string[] = [];
  if (end_distance_m !== null) texts.push(t("result.grasp.to_end", { distance: mm(end_distance_m, 0) }));
  if (over_distance_m !== null) texts.push(t("result.grasp.to_over", { distance: mm(over_distance_m, 0) }));
  if (under_distance_m !== null) texts.push(t("result.grasp.to_under", { distance: mm(under_distance_m, 0) }));
  return texts;
}

/** Say what a lift takes along or touches. */
function liftTexts({ chain, chains_above, object_above_m }: Grasp): { tone: Tone; text: string }[] {
  const texts: { tone: Tone; text: string }[] = chains_above.map((string) => ({
    tone: "warn",
    text: string === chain ? t("result.grasp.takes_itself") : t("result.grasp.takes_along", { string }),
  }));
  if (object_above_m !== null) texts.push({ tone: "warn", text: t("result.grasp.touches", { height: mm(object_above_m, 0) }) });
  return texts.length > 0 ? texts : [{ tone: "good", text: t("result.grasp.lift_free") }];
}

/** Return what is copied of a grasp. */
function copyOf(scan: Scan, grasp: Grasp, { grasps }: Reach): object {
  const { id, chain, s_m, trusted, opening_m, T_base_grasp, T_base_flange } = grasp;
  const { reachable = null, q_pregrasp_rad = null, q_grasp_rad = null } = grasps?.get(id)?.reach ?? {};
  const poses = { T_base_grasp, T_base_flange };
  return { scan: scan.id, frame: "base", grasp: id, chain, s_m, trusted, opening_m, ...poses, reachable, q_pregrasp_rad, q_grasp_rad };
}

/** Return the position of a pose. */
function positionOf(pose: Pose): number[] {
  return pose.slice(0, 3).map((row) => row[3] ?? 0);
}

/** Return the distance between the positions of two poses, metres. */
function apart_m(a: Pose, b: Pose): number {
  const [from, to] = [positionOf(a), positionOf(b)];
  return Math.hypot(...from.map((value, axis) => value - (to[axis] ?? 0)));
}
